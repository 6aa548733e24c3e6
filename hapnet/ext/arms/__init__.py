"""Arms as simulated devices: serial chains of revolute joints, from a table of links or from URDF."""
