"""The verb ``tune``."""
