"""What a machine and its network allow a servo and its messages."""
