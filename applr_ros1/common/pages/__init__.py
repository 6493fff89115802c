"""Frame, style and charts that all web pages of this package share."""
