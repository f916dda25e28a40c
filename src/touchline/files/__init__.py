"""Files: all that is read and written goes through here."""
