"""From trained checkpoints to a bundle: modules -> ONNX -> parity -> manifest."""
