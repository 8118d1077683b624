"""State spaces whose state is not measured: how they are started, trained, observed and stepped."""
