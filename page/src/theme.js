// Light or dark theme: the system's, until the user chooses one.

const root = document.documentElement;
const system = matchMedia("(prefers-color-scheme: dark)");
const kept = () => localStorage.getItem("palpate-theme");

export function theme(button, changed) {
  const apply = () => {
    root.dataset.theme = kept() ?? (system.matches ? "dark" : "light");
    const dark = root.dataset.theme === "dark";
    button.setAttribute("aria-label", dark ? "Light" : "Dark");
    button.title = dark ? "Light" : "Dark";
    changed(getComputedStyle(root).getPropertyValue("--accent").trim(), dark);
  };
  system.addEventListener("change", apply);
  button.addEventListener("click", () => {
    const next = root.dataset.theme === "dark" ? "light" : "dark";
    if ((next === "dark") === system.matches) localStorage.removeItem("palpate-theme");
    else localStorage.setItem("palpate-theme", next);
    apply();
  });
  apply();
}
