"""Where a robot is: optical trackers and other sources of poses, each behind one contract."""
