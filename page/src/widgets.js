// Widgets of the panel.

/** A row of radio buttons. `items` are [value, text]; arrow keys move along it. */
export function choice(element, items, chosen) {
  element.replaceChildren(
    ...items.map(([value, text]) => {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", textContent: text, value });
      button.setAttribute("role", "radio");
      button.onclick = () => chosen(value);
      return button;
    }),
  );
  element.onkeydown = (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    const all = [...element.children];
    const next = all[(all.indexOf(document.activeElement) + step + all.length) % all.length];
    next.focus();
    next.click();
  };
  return (value) => {
    for (const button of element.children) {
      const own = button.value === value;
      button.setAttribute("aria-checked", own);
      button.tabIndex = own ? 0 : -1;
    }
    if (![...element.children].some((button) => button.value === value)) element.firstChild?.setAttribute("tabindex", 0);
  };
}

/** A slider with a name and a value text; calls `settled` after each change. */
export function slider({ name, low, high, step, value, text, settled }) {
  const label = document.createElement("label");
  label.className = "slider";
  label.innerHTML = `<span></span><span class="value"></span><input type="range">`;
  const [title, output, input] = label.children;
  title.textContent = name;
  Object.assign(input, { min: low, max: high, step, value });
  input.setAttribute("aria-label", name);
  const show = () => {
    output.textContent = text(Number(input.value));
    input.setAttribute("aria-valuetext", output.textContent);
    input.style.setProperty("--share", `${(100 * (input.value - input.min)) / (input.max - input.min)}%`);
  };
  input.oninput = () => {
    show();
  };
  input.onchange = () => settled?.(Number(input.value));
  show();
  return {
    label,
    input,
    set(next) {
      if (document.activeElement === input && input.matches(":active")) return;
      input.value = next;
      show();
    },
  };
}

/** Format a number with significant digits and a typographic minus sign. */
export function formatNumber(value, digits = 3) {
  return Number(value.toPrecision(digits)).toString().replace("-", "−");
}
