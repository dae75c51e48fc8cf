"""How `make docs` makes the site: from README.md, docs, and the docstrings of what `import pmpnbp` offers.

Pages stay where they are and are read as they are; what their Markdown cannot say to Sphinx is put in as they are read.
Nothing comes from a network, neither when the site is built nor when it is looked at.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

from sphinx.application import Sphinx

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(ROOT), str(HERE)]

project = "pmpnbp"
author = copyright = ""
language = "en"
smartquotes = False  # words in quotes are mostly values
extensions = ["myst_parser", "sphinx.ext.autodoc", "house_docstrings"]

# Sources are found from the project's folder on, so that links between README.md and docs are as they stand
root_doc = "README"
include_patterns = ["README.md", "CHANGELOG.md", "sample_data/README.md", "docs/**.md"]
exclude_patterns = [path.name for path in ROOT.iterdir() if path.name not in ("docs", "sample_data") and path.is_dir()]

myst_heading_anchors = 4
default_role = "py:obj"
add_module_names = False
python_use_unqualified_type_names = True
autodoc_member_order = "bysource"
maximum_signature_line_length = 80
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = "pmpnbp"
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_theme_options = {"top_of_page_buttons": []}
pygments_style, pygments_dark_style = "a11y-high-contrast-light", "github-dark-high-contrast"

CONTENTS = """

```{toctree}
:hidden:
:caption: Use

docs/python
docs/batch
docs/site/examples
docs/rest
docs/viewer
docs/conventions
docs/site/reference
```

```{toctree}
:hidden:
:caption: How it works, how well

docs/algorithm
docs/calibration
docs/benchmarks
docs/experiments
sample_data/README
```

```{toctree}
:hidden:
:caption: For others

docs/deployment
docs/security
CHANGELOG
```
"""
REPORTS = "\n\n```{toctree}\n:hidden:\n:glob:\n\nexperiments/*/report\n```\n"
PICTURE = """
```{{image}} {dark}
:class: only-dark
:alt: {alt}
```

```{{image}} {light}
:class: only-light
:alt: {alt}
```
"""


def _picture(found: re.Match[str]) -> str:
    """An HTML picture for light and for dark, as the theme switches between two."""
    dark, light, alt = (re.search(name + r'="([^"]*)"', found[0]) for name in ("srcset", "src", "alt"))
    assert dark and light and alt
    return PICTURE.format(dark=dark[1], light=light[1], alt=" ".join(alt[1].split()))


def read(app: Sphinx, page: str, source: list[str]) -> None:
    """What a page is read as."""
    text = re.sub(r"<picture>.*?</picture>", _picture, source[0], flags=re.DOTALL)
    # on the site an example is read on a page, not downloaded
    text = re.sub(r"\(examples/(\w+)\.py\)", lambda found: f"(site/examples.md#{found[1]})", text)
    source[0] = text + {"README": CONTENTS, "docs/experiments": REPORTS}.get(page, "")


def finished(app: Sphinx, error: Exception | None) -> None:
    """The first page under the name by which a folder is opened."""
    if error is None:
        shutil.copyfile(app.outdir / "README.html", app.outdir / "index.html")


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", read)
    app.connect("build-finished", finished)
