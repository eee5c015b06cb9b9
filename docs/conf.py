"""Settings of the documentation site. `make docs` builds it into out/docs."""

import sys
from pathlib import Path

from via_sim.catalogue import EFFECTS  # noqa: F401  the workspace must be sourced: the reference imports VIA

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "VIA"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "docstrings",
    "command_reference",
    "interface_reference",
    "method_reference",
]
exclude_patterns = ["extensions"]
highlight_language = "bash"  # blocks without a language are shell commands

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["via.css"]
html_title = "VIA"
html_show_copyright = False
html_show_sphinx = False
html_copy_source = False

myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "undoc-members": False}
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100
add_module_names = False
toc_object_entries = False
