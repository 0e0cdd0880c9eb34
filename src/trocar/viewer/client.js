"use strict";
// Runs in viser's page before viser's client does. All that trocar changes of viser's client is here.
(() => {
  const query = "{{QUERY}}";
  const nonce = document.currentScript.nonce;
  const server = `${location.origin.replace(/^http/, "ws")}/?${query}`;
  const FIELD = "trocar";        // label of the hidden field that carries JSON both ways
  const SILENT_MS = 4000;        // the simulator sends a beat a second
  const REPORT_MS = 3000;
  const RETRY_MS = 1000;         // between the end of an attempt to connect and the next
  const MOVING_HZ = 8;           // fewer changes of the scene a second are no motion
  const COVERED_MS = 20000;      // longer no browser waits behind the cover

  // ------------------------------------------------------------------ what stands over the page
  const frame = document.createElement("div");
  frame.innerHTML = `<style>
    #trocar-cover { position: fixed; inset: 0; z-index: 400; background: #e8edf2; display: flex;
      align-items: center; justify-content: center; font: 16px system-ui, sans-serif;
      color: #33475b; transition: opacity .3s; }
    #trocar-cover.gone { opacity: 0; pointer-events: none; }
    #trocar-bar { position: fixed; top: 8px; z-index: 90; display: none; transform: translateX(-50%);
      box-sizing: border-box; background: rgba(255, 255, 255, .88); border-radius: 6px;
      padding: 3px 6px 3px 10px; font: 13px/1.5 system-ui, sans-serif; color: #1d2733;
      font-variant-numeric: tabular-nums; text-align: center; }
    #trocar-bar span + span::before { content: "\\b7"; opacity: .5; margin: 0 6px; }
    #trocar-bar span { display: inline-block; }
    #trocar-bar button { font: inherit; font-weight: 600; border: 1px solid #c6d2de; margin-left: 8px;
      border-radius: 4px; background: none; color: #1c6fa4; cursor: pointer; width: 24px; padding: 0; }
    #trocar-banner { position: fixed; top: 0; left: 0; right: 0; z-index: 500; display: none;
      background: #c92a2a; color: white; padding: 8px 16px; text-align: center;
      font: 600 15px/1.4 system-ui, sans-serif; }
    @media (max-width: 576px) { div[style*="width: 20em"] { width: 100% !important; } }
    .trocar-dead .trocar :is(b, td + td, .who), .trocar-dead #trocar-bar { visibility: hidden; }
    .trocar-dead [data-trocar="scope"] { visibility: hidden; }
    .trocar-dead :is(canvas, img) { filter: grayscale(1) opacity(.55); }
    .trocar-dead :is(input, textarea) { color: transparent !important; }
    .trocar-dead input, .trocar-dead button:not(#trocar-bar button) { pointer-events: none; }
    </style><div id="trocar-cover" role="status">trocar: connecting to the simulator ...</div>
    <div id="trocar-bar" data-trocar="bar"><span></span><button type="button"
      data-trocar-send="help/" title="Keys, hints and pages of the documentation">?</button></div>
    <div id="trocar-banner" role="alert" data-trocar="banner"></div>`;
  document.documentElement.append(frame);
  const [cover, bar, banner] = frame.querySelectorAll("#trocar-cover, #trocar-bar, #trocar-banner");
  const line = bar.firstElementChild;
  line.style.display = "contents";
  const began = performance.now();

  // ------------------------------------------------------------------ drawing without a graphics card
  const software = /swiftshader|llvmpipe|softpipe|software/i.test(renderer());
  if (software) {
    // Four samples a pixel take longer than the rest of a picture; a kept picture is a copy of it.
    const context = HTMLCanvasElement.prototype.getContext;
    const light = { antialias: false, preserveDrawingBuffer: false };
    HTMLCanvasElement.prototype.getContext = function (kind, options) {
      const given = String(kind).startsWith("webgl") ? { ...options, ...light } : options;
      return context.call(this, kind, given);
    };
    // viser lays a notice over the arms; the line above the scene has it in two words.
    const parameter = WebGL2RenderingContext.prototype.getParameter;
    WebGL2RenderingContext.prototype.getParameter = function (name) {
      return name === 0x9246 ? "" : parameter.call(this, name);  // UNMASKED_RENDERER_WEBGL
    };
  }
  function renderer() {
    const gl = document.createElement("canvas").getContext("webgl2");
    const info = gl?.getExtension("WEBGL_debug_renderer_info");
    const found = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
    gl?.getExtension("WEBGL_lose_context")?.loseContext();
    return String(found);
  }

  // ------------------------------------------------------------------ the plain level's bodies
  // Two calls draw all bodies, lit at their vertices, in place of one call for each material of
  // each body: a call costs a processor without a graphics card as much as a thousand pixels.
  const BODIES = 48;             // of one call; their poses fit the uniforms of any WebGL 2
  const HIDDEN_LAYER = 31;
  const VERTEX = `
    uniform mat4 poses[${BODIES}];
    uniform vec3 key, keyLight, skyLight;
    attribute vec4 tint;         // linear colour, body
    attribute vec2 finish;       // metalness, roughness
    varying vec3 light;
    void main() {
      mat4 pose = poses[int(tint.w + 0.5)];
      vec4 at = pose * vec4(position, 1.0);
      vec3 out_ = normalize(mat3(pose) * normal);
      float facing = max(dot(out_, key), 0.0);
      float wide = pow(max(finish.y, 0.3), 4.0), sharp = 2.0 / wide - 2.0;
      vec3 middle = normalize(key + normalize(cameraPosition - at.xyz));
      float glint = facing * (sharp + 2.0) / 8.0 * pow(max(dot(out_, middle), 0.0), sharp);
      vec3 matt = tint.rgb * (1.0 - 0.5 * finish.x) * (facing * keyLight + skyLight);
      light = (matt + mix(vec3(0.04), tint.rgb, finish.x) * glint * keyLight) / 3.14159;
      gl_Position = projectionMatrix * viewMatrix * at;
    }`;
  const FRAGMENT = `
    varying vec3 light;
    void main() {
      gl_FragColor = vec4(light, 1.0);
      #include <tonemapping_fragment>
      #include <colorspace_fragment>
    }`;
  let plain = software, batched = [], batches = [];

  // The standard materials of an own level compile for seconds: none is drawn before its batch.
  const prepared = setInterval(() => {
    const { scene, canvas2d } = window.__viserMutable ?? {};
    if (!scene) return;
    if (canvas2d) canvas2d.style.display = "none";  // viser's rectangle of a selection, unused here
    scene.onBeforeRender = () => batch(scene);
    clearInterval(prepared);
  }, 20);

  function batch(scene) {
    const bodies = plain ? bodiesOf(window.__viserMutable.nodeRefFromName) : [];
    const meshes = bodies.flat();
    if (meshes.length !== batched.length || meshes.some((mesh, k) => mesh !== batched[k])) {
      for (const mesh of batched) mesh.layers.set(0);
      for (const mesh of batches) {
        scene.remove(mesh);
        mesh.geometry.dispose();
      }
      for (const mesh of meshes) mesh.layers.set(HIDDEN_LAYER);
      batches = [];
      for (let k = 0; k < bodies.length; k += BODIES) {
        batches.push(joined(bodies.slice(k, k + BODIES)));
      }
      if (batches.length > 0) scene.add(...batches);
      batched = meshes;
    }
    batches.forEach((mesh, k) => follow(mesh, bodies.slice(BODIES * k, BODIES * (k + 1))));
  }

  // The opaque meshes without textures of each body and mark that is shown.
  function bodiesOf(nodes) {
    const bodies = [], named = new Set(Object.values(nodes));
    const shown = (node) => !node || (node.visible && shown(node.parent));
    const collect = (node, meshes) => {
      const { material } = node;
      if (material?.isMeshStandardMaterial && !material.transparent && !material.map
          && !node.isInstancedMesh) {
        meshes.push(node);
      }
      for (const child of node.children) if (!named.has(child)) collect(child, meshes);
      return meshes;
    };
    for (const name in nodes) {
      if (!/^\/(world|marks)\//.test(name) || name.startsWith("/world/drawings/")) continue;
      const meshes = nodes[name] && shown(nodes[name]) ? collect(nodes[name], []) : [];
      if (meshes.length > 0) bodies.push(meshes);
    }
    return bodies;
  }

  function joined(bodies) {
    const all = bodies.flat(), [{ geometry, constructor: Mesh }] = all;
    const { constructor: Geometry, attributes: { position } } = geometry;
    const Kind = position.constructor;  // a sphere's turns indices into floats; its base does not
    const keeps = new Kind(new Uint32Array(1), 1).array instanceof Uint32Array;
    const Attribute = keeps ? Kind : Object.getPrototypeOf(Kind);
    const { constructor: Material } = window.__viserMutable.backgroundMaterial;
    const sum = (count) => all.reduce((before, mesh) => before + count(mesh.geometry), 0);
    const vertices = sum((each) => each.attributes.position.count);
    const joint = { position: 3, normal: 3, tint: 4, finish: 2 };
    for (const name in joint) {
      joint[name] = new Attribute(new Float32Array(joint[name] * vertices), joint[name]);
    }
    const indices = new Uint32Array(
      sum(({ index, attributes }) => (index ?? attributes.position).count));
    let at = 0, end = 0;
    bodies.forEach((meshes, body) => {
      for (const { geometry: { attributes, index }, material } of meshes) {
        const { color: { r, g, b }, metalness, roughness } = material;
        joint.position.array.set(attributes.position.array, 3 * at);
        joint.normal.array.set(attributes.normal.array, 3 * at);
        if (index) for (const vertex of index.array) indices[end++] = vertex + at;
        else for (let k = 0; k < attributes.position.count; k++) indices[end++] = k + at;
        for (let left = attributes.position.count; left > 0; left--, at++) {
          joint.tint.setXYZW(at, r, g, b, body);
          joint.finish.setXY(at, metalness, roughness);
        }
      }
    });
    const own = new Geometry();
    for (const name in joint) own.setAttribute(name, joint[name]);
    own.setIndex(new Attribute(indices, 1));
    const values = { poses: new Float32Array(16 * BODIES), key: [0, 1, 0], keyLight: [0, 0, 0],
                     skyLight: [0, 0, 0] };
    const uniforms = Object.fromEntries(Object.entries(values).map(([k, value]) => [k, { value }]));
    const material = new Material({ uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT });
    const mesh = new Mesh(own, material);
    mesh.frustumCulled = mesh.matrixAutoUpdate = false;
    mesh.raycast = () => {};
    return mesh;
  }

  // Scene graph's matrices of this frame, and the lights of the level.
  function follow({ material: { uniforms } }, bodies) {
    bodies.forEach(([mesh], k) => mesh.matrixWorld.toArray(uniforms.poses.value, 16 * k));
    const nodes = window.__viserMutable.nodeRefFromName;
    const key = nodes["/light/key"]?.children[0], sky = nodes["/light/sky"];
    if (!key || !sky) return;
    const [x, y, z] = key.matrixWorld.elements.slice(12), far = Math.hypot(x, y, z);
    uniforms.key.value = [x / far, y / far, z / far];
    uniforms.keyLight.value = ["r", "g", "b"].map((c) => key.color[c] * key.intensity);
    uniforms.skyLight.value = ["r", "g", "b"].map(
      (c) => (sky.color[c] + sky.groundColor[c]) / 2 * sky.intensity);
  }

  // ------------------------------------------------------------------ the connection
  let worker = null, field = null, last = 0, lostAt = null, parting = "", changes = 0, scale = 1;

  // The page shows the secret of this run when it connects, and connects nowhere else.
  const post = Worker.prototype.postMessage;
  Worker.prototype.postMessage = function (message, ...rest) {
    // viser asks again only while its window has the focus, and ends attempts of over a second.
    if (message?.type === "retry" && this === worker) return;
    if (message?.type !== "set_server") return post.call(this, message, ...rest);
    worker = this;
    this.addEventListener("message", (event) => hear(event.data));
    return post.call(this, { ...message, server }, ...rest);
  };

  function hear(data) {
    if (data.type === "connected") {
      lostAt = null;
      last = performance.now();
    } else if (data.type === "closed") {
      lostAt ??= new Date();
      field = null;
      reloadInANewRun();
      setTimeout(() => { if (lostAt !== null) post.call(worker, { type: "retry" }); }, RETRY_MS);
    } else if (data.type === "message_batch") {
      last = performance.now();
      let moved = false;
      for (const message of data.messages) {
        if (message.type === "SetPositionMessage" || message.type === "SetOrientationMessage") {
          moved = true;
        } else if (message.type === "GuiTextMessage" && message.props.label === FIELD) {
          field = message.uuid;
          take(message.value);
          report(null);
        } else if (message.type === "GuiUpdateMessage" && message.uuid === field
                   && "value" in message.updates) {
          take(message.updates.value);
        }
      }
      changes += moved;
      return;  // `take` shows what it brings
    }
    show();
  }

  function take(text) {
    const facts = JSON.parse(text);
    if (facts.bar !== undefined) line.innerHTML = facts.bar;  // escaped by the simulator
    parting = facts.banner ?? "";
    scale = facts.scale ?? 1;
    plain = facts.plain ?? plain;
    applyScale();
    show();
  }

  function send(value) {
    if (worker === null || field === null) return;
    const message = { type: "GuiUpdateMessage", uuid: field,
                      updates: { value: JSON.stringify(value) } };
    post.call(worker, { type: "send", message });
  }

  // A page that was left open has the secret and the policy of a run that is over.
  async function reloadInANewRun() {
    try {
      const page = await (await fetch(location.href)).text();
      if (!page.includes(nonce)) location.reload();
    } catch {
      // Nothing is served: the page goes on asking.
    }
  }

  // ------------------------------------------------------------------ what the page shows of it
  function show() {
    const silent = field !== null && performance.now() - last > SILENT_MS;
    let text = "";
    if (lostAt !== null) {
      text = parting || `No connection to the simulator since ${lostAt.toTimeString().slice(0, 8)}.`
        + " The picture is the last one; the page returns when the simulator runs again.";
    } else if (silent) {
      const at = new Date(Date.now() - (performance.now() - last));
      text = `The simulator has not answered since ${at.toTimeString().slice(0, 8)}.`
        + " The picture is the last one.";
    } else {
      text = parting;
    }
    if (banner.textContent !== text) banner.textContent = text;
    banner.style.display = text ? "block" : "none";
    document.documentElement.classList.toggle("trocar-dead", lostAt !== null || silent);
    place();
    const ready = line.childElementCount > 0 || performance.now() - began > COVERED_MS;
    if (ready || (lostAt !== null && parting)) cover.className = "gone";
  }

  function place() {
    const canvas = window.__viserMutable?.canvas?.getBoundingClientRect();
    bar.style.display = line.childElementCount > 0 ? "block" : "none";
    if (!canvas || canvas.width < 60) return;
    bar.style.left = `${canvas.left + canvas.width / 2}px`;
    bar.style.width = "max-content";
    bar.style.maxWidth = `${canvas.width - 16}px`;
  }

  function applyScale() {
    const settings = window.__viserTestpoints?.devSettings;
    const ratio = scale === 1 ? null : devicePixelRatio * scale;
    if (settings && settings.get().fixedDpr !== ratio) settings.set({ fixedDpr: ratio });
  }

  // ------------------------------------------------------------------ what the simulator hears
  let window_ = { at: performance.now(), frames: 0, changes: 0 };
  function frames() { return window.__viserTestpoints?.rendererInfo.render.frame ?? 0; }
  function drawn() {
    const info = window.__viserTestpoints?.rendererInfo;
    return Boolean(info) && info.render.triangles > 500;
  }
  // A picture in full screen is part of the layout, which another width would build anew without it.
  let width = innerWidth;
  function report(rate) {
    if (!document.fullscreenElement) width = innerWidth;
    send({ width, software, frames: rate, drawn: drawn(), query });
  }
  function measure() {
    const now = performance.now(), count = frames(), span = (now - window_.at) / 1000;
    const moving = changes - window_.changes > MOVING_HZ * span;
    const rate = moving && !document.hidden ? (count - window_.frames) / span : null;
    window_ = { at: now, frames: count, changes };
    report(rate);
  }
  setInterval(measure, REPORT_MS);
  setInterval(() => {
    show();
    applyScale();
  }, 1000);
  let told = false;
  const first = setInterval(() => {
    if (field !== null && drawn()) {
      if (!told) report(null);
      told = true;
      clearInterval(first);
    }
  }, 100);
  let resized = 0;
  addEventListener("resize", () => {
    clearTimeout(resized);
    resized = setTimeout(() => { report(null); show(); }, 300);
  });

  // ------------------------------------------------------------------ presses
  // The policy lets no handler stand in an attribute of viser's HTML. Escape ends the full screen.
  addEventListener("click", (event) => {
    const sender = event.target.closest("[data-trocar-send]");
    if (sender) send({ press: sender.dataset.trocarSend });
    let at = event.target.closest('[data-trocar="full-screen"]'), picture = null;
    while (at && !(picture = at.querySelector("img"))) at = at.parentElement;
    picture?.requestFullscreen();
  });
  addEventListener("keydown", (event) => {
    if (event.key === "?" && !event.target.closest?.("input, textarea")) send({ press: "help/" });
  });
})();
