"""Firmware that speaks the real bytes, with simulated servos behind it."""
