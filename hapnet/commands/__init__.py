"""The commands: a file with a function of its own name is a command (`hapnet.cli`); commands share the other files."""
