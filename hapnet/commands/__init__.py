"""The commands: a file with a function of its name is one (`hapnet.cli`); the other files are what they share."""
