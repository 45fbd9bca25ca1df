// What scrolls sideways can be reached and scrolled with the keyboard, too.
function reachable() {
  for (const box of document.querySelectorAll(".bd-article pre, .bd-article table, .cell_output .output, mjx-container")) {
    if (box.scrollWidth > box.clientWidth) box.tabIndex = 0;
  }
}
window.addEventListener("load", reachable);
window.addEventListener("resize", reachable);

// What opens the pages below a page has a name.
for (const summary of document.querySelectorAll(".bd-sidebar-primary summary")) {
  summary.setAttribute("aria-label", "Pages below");
}
