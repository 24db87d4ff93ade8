"""Running ONNX graphs."""
