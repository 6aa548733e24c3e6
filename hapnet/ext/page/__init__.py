"""The live page: shows a running pair in a browser, from its telemetry, and changes its settings by `Controls`."""
