"""The wire format: CDR, message conversion, topics and QoS."""
