"use strict";
// Runs in viser's page before viser's client does.
(() => {
  const query = "{{QUERY}}";
  const server = `${location.origin.replace(/^http/, "ws")}/?${query}`;

  // The page shows the secret of this run when it connects, and connects nowhere else.
  const post = Worker.prototype.postMessage;
  Worker.prototype.postMessage = function (message, ...rest) {
    if (message?.type !== "set_server") return post.call(this, message, ...rest);
    this.addEventListener("message", (event) => {
      if (event.data.type === "closed") reloadInANewRun();
    });
    return post.call(this, { ...message, server }, ...rest);
  };

  // A page that was left open has the secret of a run that is over.
  async function reloadInANewRun() {
    try {
      const page = await (await fetch(location.href)).text();
      if (!page.includes(query)) location.reload();
    } catch {
      // Nothing is served: viser's client goes on asking.
    }
  }

  // The policy lets no handler stand in an attribute of viser's HTML. Escape ends the full screen.
  addEventListener("click", (event) => {
    let at = event.target.closest('[data-trocar="full-screen"]'), picture = null;
    while (at && !(picture = at.querySelector("img"))) at = at.parentElement;
    picture?.requestFullscreen();
  });
})();
