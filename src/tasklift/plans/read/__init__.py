"""Readers of floor plans and graphs, one format a module."""
