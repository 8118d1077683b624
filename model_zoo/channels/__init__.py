"""What families need to know of channels: centre and size, the mirror of a body, cells of commands."""
