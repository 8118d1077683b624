"""The serial link of a physical robot: RCB/1 frames and messages, the host's session, the port."""
