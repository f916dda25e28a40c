"""`touchline mark`: points, regions and lines clicked on a local page and saved as the files that calibrations read."""
