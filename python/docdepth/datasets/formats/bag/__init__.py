"""Recordings of ROS: bags of version 1 and 2, and MCAP files."""
