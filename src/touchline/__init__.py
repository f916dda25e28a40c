"""Touchline tells a soccer robot where it stands, from the white lines of the field."""
