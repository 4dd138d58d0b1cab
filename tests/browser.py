"""What a page looks like in a browser: boxes of its cells, sizes of its text, at a window's width."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
_MEASURE = """
function look(doc, win) {
  const wide = win.innerWidth, bad = [];
  const name = e => e.tagName + ' ' + (e.textContent || '').trim().slice(0, 40);
  for (const cell of doc.querySelectorAll('td, th')) {
    const box = cell.getBoundingClientRect();
    if (!(box.width > 0 && box.height > 0)) {
      // a heading may be hidden where each cell of its column shows it
      const below = cell.closest('table').querySelectorAll('tbody td:nth-child(' + (cell.cellIndex + 1) + ')');
      const shows = td => win.getComputedStyle(td, '::before').content === JSON.stringify(cell.textContent);
      if (cell.tagName !== 'TH' || !below.length || ![...below].every(shows)) bad.push('no box: ' + name(cell));
      continue;
    }
    if (box.left < -0.5 || box.right > wide + 0.5) bad.push('outside: ' + name(cell));
    if (!cell.textContent.trim()) bad.push('empty: ' + name(cell));
    if (cell.scrollWidth > cell.clientWidth + 1) bad.push('wider than its box: ' + name(cell));
    for (let e = cell.parentElement; e && e !== doc.documentElement; e = e.parentElement) {
      const style = win.getComputedStyle(e);
      if (/(auto|scroll|hidden|clip)/.test(style.overflowX + style.overflowY)) bad.push('clipping: ' + name(e));
    }
  }
  const spread = doc.documentElement.scrollWidth;
  if (spread > wide + 1) bad.push('page wider than window: ' + spread);
  let smallest = 1e9, least = '';
  const walk = doc.createTreeWalker(doc.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const e = walk.currentNode.parentElement;
    if (!walk.currentNode.textContent.trim() || /STYLE|SCRIPT/.test(e.tagName)) continue;
    let size = parseFloat(win.getComputedStyle(e).fontSize);
    const svg = e.closest('svg');
    if (svg) size *= svg.getBoundingClientRect().width / svg.viewBox.baseVal.width;
    if (size < smallest) { smallest = size; least = name(e); }
  }
  return {bad: bad.slice(0, 20), cells: doc.querySelectorAll('td').length, smallest, least};
}
"""


def measured(page: str, width: int, folder: Path) -> dict:
    """Open a page in a frame of this width; what is wrong with its tables, and its smallest text in pixels."""
    assert CHROMIUM is not None
    outer = (
        f'<!DOCTYPE html><meta charset="utf-8"><body style="margin:0"><iframe id="f" style="border:0" width="{width}" '
        f'height="900" srcdoc="{html.escape(page)}"></iframe><pre id="out"></pre><script>{_MEASURE}'
        "document.getElementById('f').onload = function () { const f = this;"
        "document.getElementById('out').textContent = JSON.stringify(look(f.contentDocument, f.contentWindow)); };"
        "</script></body>"
    )
    path = folder / f"outer_{width}.html"
    path.write_text(outer, encoding="utf-8")
    text = run("--dump-dom", "--virtual-time-budget=5000", path.as_uri())
    found = re.search(r'<pre id="out">(.*?)</pre>', text, re.S)
    assert found and found[1], text[-2000:]
    return json.loads(html.unescape(found[1]))


def screenshot(page: str, width: int, height: int, target: Path) -> None:
    """A picture of a page, to be looked at."""
    frame = (
        f'<!DOCTYPE html><meta charset="utf-8"><body style="margin:0"><iframe style="border:0" width="{width}" '
        f'height="{height}" srcdoc="{html.escape(page)}"></iframe></body>'
    )
    path = target.with_suffix(".html")
    path.write_text(frame, encoding="utf-8")
    run(f"--screenshot={target}", f"--window-size={max(width, 500)},{height}", path.as_uri())


def run(*arguments: str) -> str:
    """Chromium's standard output."""
    assert CHROMIUM is not None
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=True).stdout
