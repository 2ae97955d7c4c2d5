"""Benchmarks and proofs of the firmware bridge."""
