"""Where records go: Zenoh, ROS 2, MAVLink."""
