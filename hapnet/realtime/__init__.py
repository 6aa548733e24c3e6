"""Real time: one side runs in this process, over a transport and through the emulated link."""
