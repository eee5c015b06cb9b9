"""Every table and quoted figure of the document that VIA reproduces: experiments by section, rows, pictures, pages."""
