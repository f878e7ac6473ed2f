"""Telemetry as flight units send it: packets to bytes and back, and where they are sent."""
