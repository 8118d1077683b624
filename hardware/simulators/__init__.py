"""External simulators as robots, one module each: their recording, and controllers run in them."""
