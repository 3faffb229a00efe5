"""Pages that need nothing but themselves: templates with figures in them."""

import base64
import io
from typing import TYPE_CHECKING, Any

from tankrig.extras import needing_extra

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def inlined(figure: "Figure", kind: str = "png") -> str:
    """A figure as a data address."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, dpi=110)
    text = base64.b64encode(buffer.getvalue()).decode()
    return f"data:image/{'svg+xml' if kind == 'svg' else kind};base64,{text}"


def rendered(template: str, package: str = "tankrig.report", **values: Any) -> str:
    """A page of a template beside a package's modules; it may extend base.html, which stands beside this file."""
    with needing_extra("a report"):
        import jinja2

    loader = jinja2.ChoiceLoader([jinja2.PackageLoader(one, "") for one in (package, "tankrig.report")])
    return jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True).get_template(template).render(values)
