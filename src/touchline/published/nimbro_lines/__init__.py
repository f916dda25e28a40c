"""nimbro-lines (Schulz and Behnke 2012)."""
