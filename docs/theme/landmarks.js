/* The theme gives its landmarks no names of their own, so screen readers list several that sound alike. */
function nameLandmarks() {
  document.querySelectorAll("nav.md-code__nav").forEach((nav, i) => nav.setAttribute("aria-label", `Code ${i + 1}`));
  document.querySelectorAll("nav.md-nav:not(.md-nav--primary, .md-nav--secondary)").forEach((nav, i) => {
    nav.removeAttribute("aria-labelledby");
    nav.setAttribute("aria-label", `Group ${i + 1}`);
  });
  document.querySelectorAll(".md-search[role=dialog]").forEach((box) => box.setAttribute("aria-label", "Search"));
  document.querySelectorAll("input.md-toggle").forEach((box) => box.setAttribute("aria-hidden", "true"));
  document.querySelectorAll(".md-typeset pre > code, .md-typeset table").forEach((wide) => {
    if (wide.scrollWidth > wide.clientWidth) wide.tabIndex = 0; // what scrolls can be reached by keyboard
  });
}
new MutationObserver(nameLandmarks).observe(document.body, { childList: true, subtree: true });
nameLandmarks();
