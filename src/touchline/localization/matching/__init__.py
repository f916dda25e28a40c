"""Registration of line points to the distance map, the search of the whole field, and what a match is worth."""
