"""Recordings in and out, the decision log, pictures and the report."""
