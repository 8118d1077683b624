"""A framework that identifies models of a robot, evolves controllers in them and compares both."""
