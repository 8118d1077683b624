"""Choice among families by free runs on what was held out, for the mean of those that are kept (`auto`)."""
