"""Simulated drives in the layouts of KITTI, DSEC and ROS bags."""
