"""Drawing on footage with OpenCV."""
