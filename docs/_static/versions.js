// Offer the other published versions. `versions.json` is beside the folder of this version; without it (pages
// built on one's own machine) there is nothing to choose, and the box stays hidden.
document.addEventListener("DOMContentLoaded", async () => {
  const box = document.querySelector(".versions");
  const select = document.getElementById("versions");
  if (!box || !location.protocol.startsWith("http")) return;
  const root = new URL(select.dataset.root || "./", location.href);
  const answer = await fetch(new URL("../versions.json", root)).catch(() => null);
  if (!answer?.ok) return;
  const here = root.pathname.split("/").at(-2);
  const page = location.href.slice(root.href.length);
  for (const version of await answer.json()) {
    select.add(new Option(version, version, version === here, version === here));
  }
  select.addEventListener("change", async () => {
    const chosen = new URL(`../${select.value}/`, root);
    // A page that the chosen version does not have leads to its first page.
    const same = await fetch(new URL(page, chosen), { method: "HEAD" }).catch(() => null);
    location.assign(same?.ok ? new URL(page, chosen) : chosen);
  });
  box.hidden = false;
});
