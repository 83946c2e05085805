"""Speed and accuracy, measured: the exact oracle, the textbook baseline, the peers, the reports."""
