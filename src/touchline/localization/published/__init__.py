"""What only the published systems have."""
