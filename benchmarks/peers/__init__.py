"""What others make of the same scans."""
