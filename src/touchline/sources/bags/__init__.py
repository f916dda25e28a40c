"""Bags: MCAP files, rosbag2 folders and ROS 1 bags, read and written without a ROS installation."""
