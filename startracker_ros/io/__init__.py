"""Files and wires: bags, images and camera files, exports, telemetry, tables."""
