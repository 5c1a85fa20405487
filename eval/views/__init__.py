"""The comparison shown: terminal, Markdown, pictures, HTML report, films."""
