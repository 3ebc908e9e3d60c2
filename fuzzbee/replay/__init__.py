"""The verb ``replay``."""
