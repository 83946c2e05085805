"""What a scan returns, and what is made of it: point clouds, boxes, images, maps."""
