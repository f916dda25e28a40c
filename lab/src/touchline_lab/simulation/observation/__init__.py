"""What a detector would find, without an image."""
