"""What the commands do, a module each; `hapnet.cli` declares them and imports these only when they run."""
