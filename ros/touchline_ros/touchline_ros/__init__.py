"""Touchline as a node of ROS 2, and a bridge to it."""
