// What the body is: its title, what lies in it, and how it was made.

/** Show these texts of a message `preparing` or `hello`. */
export function showBody(byId, { title, subtitle = "", notes = [] }) {
  document.title = `${title} · palpate`;
  byId("title").textContent = title;
  byId("contents").textContent = subtitle;
  byId("contents").hidden = !subtitle;
  byId("about").hidden = notes.length === 0;
  const list = byId("notes");
  if (notes.length === list.children.length && notes.every((note, k) => list.children[k].textContent === note)) return;
  list.replaceChildren(
    ...notes.map((note) => {
      const line = document.createElement("li");
      line.textContent = note;
      return line;
    }),
  );
}
