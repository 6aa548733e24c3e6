"""Zenoh: keys, configuration, security, and diagnosis of connections. No other package uses Zenoh."""
