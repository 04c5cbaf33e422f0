"""Experiments: what is compared with what, and what came out."""
