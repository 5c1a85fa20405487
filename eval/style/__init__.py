"""What pages and pictures share: colours, axes, tables in Markdown, numbers as text."""
