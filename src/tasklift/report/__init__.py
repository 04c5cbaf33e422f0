"""Pages and charts that stand alone: HTML, SVG, one palette."""
