"""What stands in a simulated street, as textured triangles."""
