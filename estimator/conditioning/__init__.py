"""From a real IMU to the paper's vectors with confidences."""
