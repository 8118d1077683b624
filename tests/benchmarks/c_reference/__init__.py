"""The rollout engine against hand-written C: one .c file a model, `export` writes its parameters."""
