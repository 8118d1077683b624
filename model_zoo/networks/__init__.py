"""Networks as plain arrays, trained through simulations."""
