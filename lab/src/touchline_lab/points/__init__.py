"""Point sets: frames of line points with their true poses, and how well a localizer finds these."""
