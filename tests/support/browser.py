"""Web pages in a headless browser.

It may neither complain nor ask the network for anything, and axe must find no fault.
"""

import contextlib
import shutil

import pytest

PROGRAM = shutil.which("chromium-headless-shell")
OPTIONS = ["--no-sandbox", "--disable-dev-shm-usage"]  # The tests may run as root.
SETTLES_MS = 10_000.0  # longest time in which a page is drawn anew [ms]
NARROW_PX = 360  # narrowest screen that the pages fit
needs_browser = pytest.mark.skipif(PROGRAM is None, reason="no headless Chromium here")


@contextlib.contextmanager
def opened(path):
    """Open a file as a page.

    Afterwards the console must be empty, the file the only request, and axe must find no fault.

    Nothing moves by itself: the page is told that its reader wants little motion.
    """
    playwright = pytest.importorskip("playwright.sync_api")
    complaints = []
    requests = []
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=PROGRAM, args=OPTIONS)
        page = browser.new_page(
            viewport={"width": 1280, "height": 800}, color_scheme="dark", reduced_motion="reduce"
        )
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda message: complaints.append(message.text))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(path.as_uri())
        yield page
        faults = faults_of(page)
        page.set_viewport_size({"width": NARROW_PX, "height": 640})
        # Charts are drawn anew in the frames after the change of size.
        fits = f"document.documentElement.scrollWidth <= {NARROW_PX}"
        with contextlib.suppress(playwright.TimeoutError):
            page.wait_for_function(fits, timeout=SETTLES_MS)
        is_narrow = page.evaluate(fits)
        browser.close()
    assert complaints == []
    assert [request for request in requests if not request.startswith("data:")] == [path.as_uri()]
    assert faults == []
    assert is_narrow, "a narrow screen scrolls sideways"


def faults_of(page):
    """Return the serious faults that axe finds on a page: those that shut some readers out."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    faults = []
    for violation in axe.Axe().run(page).response["violations"]:
        if violation["impact"] in ("serious", "critical"):
            # Enough to find the fault: it may be that of every row of a table.
            first_elements = [node["html"] for node in violation["nodes"][:3]]
            faults.append(f"{violation['id']}: {first_elements}")
    return faults


def focused(page, role, name):
    """Return an element that a reader without a mouse has reached."""
    element = page.get_by_role(role, name=name).first
    element.focus()
    assert element.evaluate("element => element === document.activeElement")
    return element


def shown_methods(view):
    """Return the first words of the table's rows below its header."""
    methods = []
    for table_row in view.get_by_role("row").all()[1:]:
        methods.append(table_row.inner_text().split()[0])
    return methods
