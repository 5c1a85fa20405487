"""Views of the comparison: terminal, Markdown, pictures, HTML report, films."""
