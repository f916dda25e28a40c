"""Every pose that explains an observation."""
