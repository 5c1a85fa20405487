"""Common style of pages and pictures: colours, axes, tables in Markdown, titles and digits of metrics."""
