"""What a sensor does to a pulse, and the IMUs and GNSS receivers beside it."""
