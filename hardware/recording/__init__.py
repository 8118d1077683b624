"""Recording: manoeuvres that excite a robot, journals of its response, and data sets made of them."""
