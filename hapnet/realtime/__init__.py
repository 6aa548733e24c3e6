"""Real time: one side in this process, over a transport, through the emulated link."""
