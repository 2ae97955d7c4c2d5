"""Building blocks of a page that needs nothing but itself: no script, no address outside."""

import base64
import html
import math
from pathlib import Path
from typing import List, Sequence

import cv2

from apex_edge.errors import RecordingError
from apex_edge.types import Array

CSS = """
:root{--bg:#f5f6f8;--card:#fff;--ink:#1c232b;--dim:#66707c;--line:#e1e5ea;--accent:#2563a8;
--good:#1d8348;--good-bg:#e2f4e9;--bad:#b8322f;--bad-bg:#fbe5e4;--warn:#9a6306;--warn-bg:#fdf0d8;
--bar:#4c8fd0;--bar2:#b9d4ee}
@media(prefers-color-scheme:dark){:root{--bg:#12161b;--card:#1b2128;--ink:#e6e9ed;--dim:#98a3af;
--line:#2d3640;--accent:#7db4ea;--good:#63cf90;--good-bg:#173526;--bad:#f08c86;--bad-bg:#42201f;
--warn:#e9b35a;--warn-bg:#3d2f14;--bar:#5b9ddd;--bar2:#2b4763}}
*{box-sizing:border-box}
body{margin:0;background:var(--bg);color:var(--ink);line-height:1.5;
font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif}
main{max-width:1080px;margin:0 auto;padding:28px 20px 60px}
h1{font-size:1.75rem;line-height:1.2;margin:0 0 6px;letter-spacing:-.01em}
h2{font-size:1.25rem;margin:40px 0 12px;letter-spacing:-.01em}
h3{font-size:1rem;margin:22px 0 8px}
p{margin:6px 0}.dim{color:var(--dim)}
code{font:13px/1.4 ui-monospace,"SF Mono",Menlo,Consolas,"DejaVu Sans Mono",monospace;
background:var(--line);border-radius:5px;padding:2px 6px;overflow-wrap:anywhere}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:12px;margin:22px 0}
.tile{background:var(--card);border:1px solid var(--line);border-radius:12px;padding:14px 16px}
.tile b{display:block;font-size:1.6rem;line-height:1.2;font-variant-numeric:tabular-nums}
.tile span{color:var(--dim);font-size:.85rem}
.card{background:var(--card);border:1px solid var(--line);border-radius:14px;padding:18px 20px;
margin:14px 0}
.wide{overflow-x:auto}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums;font-size:.92rem}
th{text-align:left;color:var(--dim);font-weight:600;font-size:.8rem;white-space:nowrap}
th,td{padding:7px 12px 7px 0;border-bottom:1px solid var(--line);vertical-align:top}
tr:last-child td{border-bottom:0}td.n,th.n{text-align:right;white-space:nowrap}
td.w{min-width:220px}
.tag{display:inline-block;border-radius:99px;padding:1px 10px;font-size:.82rem;font-weight:600;
white-space:nowrap;background:var(--line);color:var(--ink)}
.good{background:var(--good-bg);color:var(--good)}.bad{background:var(--bad-bg);color:var(--bad)}
.warn{background:var(--warn-bg);color:var(--warn)}
figure{margin:16px 0 0}figcaption{color:var(--dim);font-size:.86rem;margin-top:6px}
img,video,svg{display:block;max-width:100%;height:auto;border-radius:10px}
.two{display:grid;grid-template-columns:minmax(0,1fr) minmax(0,1fr);gap:0 24px;align-items:start}
.head{display:flex;flex-wrap:wrap;gap:4px 12px;align-items:baseline;justify-content:space-between}
.head h2{margin:0}
svg text{font:12px system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif;
fill:var(--ink);paint-order:stroke;stroke:var(--card);stroke-width:4px;stroke-linejoin:round}
svg{max-width:760px}.wide>svg{min-width:520px;width:100%}
svg .dim{fill:var(--dim)}
dl{display:grid;grid-template-columns:max-content 1fr;gap:4px 16px;margin:0;font-size:.92rem}
dt{color:var(--dim)}dd{margin:0;overflow-wrap:anywhere}
a{color:var(--accent)}
@media(max-width:720px){main{padding:18px 12px 40px}.two{grid-template-columns:1fr}
.card{padding:14px}h1{font-size:1.4rem}}
"""

MAX_EMBEDDED_BYTES = 8 * 1024 * 1024
PLAYABLE = {".webm": "video/webm"}
"""What browsers play of what OpenCV can write."""


def esc(text: object) -> str:
    """Return text safe to stand in HTML."""
    return html.escape(str(text), quote=True)


def page(title: str, body: str) -> str:
    """Return a whole page."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{esc(title)}</title>\n<style>{CSS}</style>\n</head>\n"
        f"<body><main>\n{body}\n</main></body>\n</html>\n"
    )


def tag(text: str, kind: str = "") -> str:
    """Return a coloured word; ``kind`` is good, bad, warn or nothing."""
    return f'<span class="tag {kind}">{esc(text)}</span>'


def tiles(items: Sequence[Sequence[str]]) -> str:
    """Return the figures that matter: pairs of figure and what it counts."""
    cells = [f'<div class="tile"><b>{esc(b)}</b><span>{esc(s)}</span></div>' for b, s in items]
    return f'<div class="tiles">{"".join(cells)}</div>'


def table(head: Sequence[str], rows: Sequence[Sequence[str]], n_text: int = 1) -> str:
    """Return a table; the first ``n_text`` columns are text, the others figures to the right.

    Cells are HTML already; heads are text.
    """
    kinds = ["" if i < n_text else ' class="n"' for i in range(len(head))]
    top = "".join(f"<th{kind}>{esc(name)}</th>" for kind, name in zip(kinds, head))
    lines: List[str] = []
    for row in rows:
        cells = "".join(f"<td{kind}>{cell}</td>" for kind, cell in zip(kinds, row))
        lines.append(f"<tr>{cells}</tr>")
    body = "".join(lines)
    return (
        f'<div class="wide"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def figure(content: str, caption: str) -> str:
    """Return a picture with its caption."""
    return f"<figure>{content}<figcaption>{esc(caption)}</figcaption></figure>"


def image(picture: Array, alt: str, is_flat: bool = False) -> str:
    """Return a BGR picture inside the page: PNG for flat colours, else JPEG.

    Raises
    ------
    RecordingError : OpenCV cannot encode it.
    """
    suffix, kind = (".png", "png") if is_flat else (".jpg", "jpeg")
    options = [] if is_flat else [cv2.IMWRITE_JPEG_QUALITY, 86]
    is_done, data = cv2.imencode(suffix, picture, options)
    if not is_done:
        raise RecordingError(f"cannot encode the picture {alt!r}")
    coded = base64.b64encode(data.tobytes()).decode("ascii")
    height, width = picture.shape[:2]
    return (
        f'<img alt="{esc(alt)}" width="{width}" height="{height}" '
        f'src="data:image/{kind};base64,{coded}">'
    )


def video(path: Path, link: str) -> str:
    """Return a video inside the page where it is small and browsers play it, and a link to it.

    Raises
    ------
    RecordingError : the video cannot be read.
    """
    try:
        size = path.stat().st_size
        is_embedded = path.suffix in PLAYABLE and size <= MAX_EMBEDDED_BYTES
        coded = base64.b64encode(path.read_bytes()).decode("ascii") if is_embedded else ""
    except OSError as error:
        raise RecordingError(f"{path}: cannot read: {error}") from error
    player = ""
    if is_embedded:
        source = f"data:{PLAYABLE[path.suffix]};base64,{coded}"
        player = f'<video controls muted preload="metadata" src="{source}"></video>'
    words = f'<a href="{esc(link)}">{esc(path.name)}</a> ({size / 1e6:.1f} MB)'
    return f"<figure>{player}<figcaption>Annotated video: {words}</figcaption></figure>"


def seconds(value: float, decimals: int = 2) -> str:
    """Return a time for a table; what never happened is a dash."""
    return f"{value:.{decimals}f}" if math.isfinite(value) else "&ndash;"
