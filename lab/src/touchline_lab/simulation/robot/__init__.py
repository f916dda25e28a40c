"""How robots move and what their sensors tell of it."""
