"""Bytes over UDP, TCP or a serial line."""
