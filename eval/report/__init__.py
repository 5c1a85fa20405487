"""The comparison shown: terminal, Markdown, pictures, HTML report, films; and what all pages share."""
