"""Recording: manoeuvres that excite a robot, journals of how it answers, and data sets made of them."""
