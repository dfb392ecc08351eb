"""What runs: the robot, the observer, the recordings, the command line."""
