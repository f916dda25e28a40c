"""Registration of line points at the statistical bound: its steps, and the search for where to begin."""
