"""Driving by a person or a controller: trials of a task, and the local web page that shows them and reads the keys."""
