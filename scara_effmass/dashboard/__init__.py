"""Web page of a cell for its operator (NiceGUI)."""
