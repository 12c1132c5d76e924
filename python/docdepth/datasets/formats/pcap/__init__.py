"""Packets of Hesai's, Velodyne's and Ouster's LiDARs, captured from the network."""
