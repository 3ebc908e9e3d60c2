"""Rotations, frames, and the angles between attitudes."""
