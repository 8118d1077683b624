"""The rollout engine compared with plain C: one .c file per model, `export` writes its parameters."""
