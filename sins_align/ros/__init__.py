"""Everything that knows ROS: bags, messages, the base of the nodes, the commands."""
