"""Commands that the lab adds to `touchline`."""
