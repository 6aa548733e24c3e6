"""The live page: what a running pair does, in a browser. It reads telemetry, and changes things by `Controls`."""
