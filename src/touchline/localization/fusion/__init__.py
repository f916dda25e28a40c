"""Poses over time: filters, modes, compass correction, and when a pose is believed wrong."""
