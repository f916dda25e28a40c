"""Localization on a running robot: what comes in by whatever link, what goes out, and the loop between."""
