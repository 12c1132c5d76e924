"""Calibration of a camera and a LiDAR from still checkerboards (paper III-A)."""
