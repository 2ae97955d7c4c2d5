"""Frame codecs: bytes <-> values, pure functions."""
