"""The paper: filter and fuzzy controller, each as it reads and compiled."""
