"""What is scanned: shapes, scenes, and the air between them."""
