// Buttons, sliders and keys.

const FINGERS = ['Thumb', 'Index', 'Middle', 'Ring', 'Little'];
const SPEEDS = [1, 0.5, 0.25, 2];
const SPREAD = 1;  // which of a finger's angles
const NARROW = '(max-width: 760px)';
const find = (id) => document.getElementById(id);

export class Controls {
  constructor(player, stage, description) {
    Object.assign(this, { player, stage, description });
    this.pose = undefined;  // the name of the one that is held
    this.base = undefined;  // angles that the sliders count from
    this.showAbout();
    this.addPoses();
    this.addFingers();
    this.addLight();
    this.addBar();
    this.addKeys();
    this.opened(!matchMedia(NARROW).matches);
    matchMedia(NARROW).addEventListener('change', (narrow) => this.opened(!narrow.matches));
    addEventListener('resize', () => this.makeRoom());
    this.refresh();
  }

  showAbout() {
    const { name, license, handedness, gaussians, learned_from: learned, notes } = this.description;
    find('subtitle').textContent = `${handedness === 'left' ? 'Left' : 'Right'} hand · ${gaussians.toLocaleString('en')} Gaussians`;
    find('credit').textContent = license;
    const lines = [...(name === document.title ? [] : [name]), ...(learned ? [`Learned from ${learned}`] : []), `License: ${license}`, ...notes];
    find('about').append(...lines.map((line) => Object.assign(document.createElement('p'), { textContent: line })));
    const credit = Object.assign(document.createElement('p'), { textContent: `${this.description.made_by}. Drawn with three.js; licenses in LICENSES.txt.` });
    find('about').append(credit);
  }

  addPoses() {
    this.chips = Object.entries(this.player.articulated.poses).map(([name, angles]) => {
      const chip = document.createElement('button');
      chip.textContent = name.replaceAll('_', ' ');
      chip.addEventListener('click', () => this.take(name, angles));
      find('poses').append(chip);
      return [name, chip];
    });
  }

  take(name, angles) {
    this.pose = name;
    this.base = undefined;
    this.player.hold(angles, true);
  }

  addFingers() {
    const { articulated } = this.player, degree = Math.PI / 180;
    this.sliders = FINGERS.map((title, f) => {
      const row = Object.assign(document.createElement('div'), { className: 'row' });
      const label = Object.assign(document.createElement('label'), { textContent: title, htmlFor: `curl${f}` });
      const curl = slider({ id: `curl${f}`, min: -0.15, max: 1, step: 0.005 }, `${title} curl`);
      const [low, high] = articulated.ranges[f][SPREAD];
      const spread = slider({ min: low / degree, max: high / degree, step: 0.25 }, `${title} spread`);
      spread.classList.add('both');
      row.append(label, curl, spread);
      find('fingers').append(row);
      const change = (bent) => {
        const { angles } = this.player.goal;
        this.base ??= angles;
        this.pose = undefined;
        this.player.bend(f, bent(angles[f], this.base[f]));
      };
      // counted from the pose where the sliders were first touched, so that it comes back with the slider
      curl.addEventListener('input', () => change((now, base) => {
        const bent = articulated.curledBy(base, f, curl.value - articulated.curl(base, f));
        return bent.map((angle, k) => (k === SPREAD ? now[k] : angle));
      }));
      spread.addEventListener('input', () => change((now) => now.map((angle, k) => (k === SPREAD ? spread.value * degree : angle))));
      return { curl, spread };
    });
  }

  // A sun that is turned around the hand, as it was seen at first
  addLight() {
    if (!this.description.light) return;
    const [around, height] = [['around', 180, -40], ['height', 90, 35]].map(([id, most, value]) => {
      const made = slider({ id, min: -most, max: most, step: 1 }, `Light ${id}`);
      made.classList.add('both');
      document.querySelector(`#light label[for=${id}]`).after(made);
      made.addEventListener('input', () => turn());
      set(made, value);
      return made;
    });
    const turn = () => this.stage.lightFrom(Number(around.value), Number(height.value));
    const own = find('own');
    own.addEventListener('click', () => (own.ariaPressed === 'true' ? turn() : this.stage.ownLight()));
    this.stage.lit = (...angles) => {
      own.ariaPressed = String(!angles.length);
      if (!angles.length) return;
      // whoever drives the page may turn it more than once around
      set(around, Math.abs(angles[0]) > 180 ? angles[0] - 360 * Math.round(angles[0] / 360) : angles[0]);
      set(height, angles[1]);
    };
    find('light').hidden = false;
  }

  addBar() {
    const { player, stage } = this, moves = player.motion.frames > 1;
    find('play').addEventListener('click', () => this.toggle());
    find('time').max = Math.max(player.motion.frames - 1, 1);
    find('time').addEventListener('input', (event) => {
      player.playing = false;
      this.forget();
      player.seek(Number(event.target.value));
    });
    find('speed').addEventListener('click', () => {
      player.speed = SPEEDS[(SPEEDS.indexOf(player.speed) + 1) % SPEEDS.length];
      this.refresh();
    });
    find('home').addEventListener('click', () => {
      stage.touched = false;
      stage.home();
    });
    find('more').addEventListener('click', () => this.opened(document.body.classList.contains('bare')));
    for (const id of ['play', 'time', 'speed', 'clock']) find(id).hidden = !moves;
    stage.controls.addEventListener('start', () => { stage.touched = true; });
  }

  addKeys() {
    addEventListener('keydown', (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const { player } = this, ranged = event.target.type === 'range';
      const keys = {
        ' ': () => this.toggle(),
        r: () => find('home').click(),
        p: () => this.opened(document.body.classList.contains('bare')),
        ArrowLeft: () => this.jump(Math.ceil(player.frame) - 1),
        ArrowRight: () => this.jump(Math.floor(player.frame) + 1),
      };
      if (!(event.key in keys) || (ranged && event.key.startsWith('Arrow'))) return;
      if (event.target.tagName === 'BUTTON' && event.key === ' ') return;
      keys[event.key]();
      event.preventDefault();
    });
  }

  jump(frame) {
    this.player.playing = false;
    this.forget();
    this.player.seek(frame);
  }

  toggle() {
    if (this.player.playing) return this.player.pause();
    this.forget();
    this.player.play();
  }

  forget() {
    this.pose = this.base = undefined;
  }

  opened(open) {
    document.body.classList.toggle('bare', !open);
    find('more').setAttribute('aria-expanded', String(open));
    find('panel').inert = !open;
    this.makeRoom();
  }

  makeRoom() {
    const open = !document.body.classList.contains('bare'), narrow = matchMedia(NARROW).matches;
    const panel = find('panel'), bar = find('bar').offsetHeight + 2 * find('bar').offsetLeft;
    this.stage.keepFree({
      top: narrow ? find('head').offsetTop + find('head').offsetHeight : 0,
      right: open && !narrow ? panel.offsetWidth + 16 : 0,
      bottom: bar + (open && narrow ? panel.offsetHeight : 0),
    });
  }

  // What the player does is shown, whoever asked for it
  refresh() {
    const { player } = this, { frames, fps } = player.motion;
    document.body.classList.toggle('playing', player.playing);
    find('play').setAttribute('aria-label', player.playing ? 'Pause' : 'Play');
    find('speed').textContent = `${player.speed}×`;
    set(find('time'), Math.min(player.frame, frames - 1));
    const shown = Math.min(player.frame, frames - 1) / fps;
    find('clock').textContent = `${shown.toFixed(2)} / ${((frames - 1) / fps).toFixed(2)} s`;
    const { angles } = player.goal;
    this.sliders.forEach(({ curl, spread }, f) => {
      if (document.activeElement !== curl || !player.holds || !this.base) set(curl, player.articulated.curl(angles[f], f));
      if (document.activeElement !== spread || !player.holds || !this.base) set(spread, (angles[f][SPREAD] * 180) / Math.PI);
    });
    for (const [name, chip] of this.chips) chip.setAttribute('aria-pressed', String(player.holds && name === this.pose));
  }
}

function slider(options, label) {
  const made = Object.assign(document.createElement('input'), { type: 'range' }, options);
  made.setAttribute('aria-label', label);
  made.addEventListener('input', () => set(made, made.value));
  return made;
}

function set(range, value) {
  range.value = value;
  const part = (range.value - range.min) / (range.max - range.min);
  range.style.setProperty('--part', `${100 * part}%`);
}
