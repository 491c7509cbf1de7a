// Starts the page: header, connection banner, token dialog, router, event stream.
import {hooks, takeLinkToken, token} from './api.js';
import {fill, h, text} from './dom.js';
import {parseRoute, startRouter} from './router.js';
import {isActive, isVisitor, retryNow, startSync, state, watch} from './store.js';
import {announce, kindOf, problemBox, SCOPE_MEANS, subjectOf} from './ui.js';
import {homeView} from './views/home.js';
import {datasetView} from './views/dataset.js';
import {sceneView} from './views/scene.js';
import {jobView} from './views/job.js';
import {jobsView} from './views/jobs.js';
import {systemView} from './views/system.js';

const views = {
  home: homeView,
  dataset: datasetView,
  scene: sceneView,
  job: jobView,
  jobs: jobsView,
  system: systemView
};
const main = document.getElementById('main');
let leave = null;
let tokenRefused =
    false;  // the token dialog was closed without one: not asked again until the reader tries

function show(route) {
  leave?.abort();
  leave = new AbortController();
  const view = views[route.view];
  const root = h('div', {class: `view view-${route.view}`});
  fill(main, root);
  document.querySelectorAll('.top nav a')
      .forEach(
          (a) =>
              (a.dataset.view === route.view ? a.setAttribute('aria-current', 'page') :
                                               a.removeAttribute('aria-current')));
  setTitle(route.id ?? route.view);
  scrollTo(0, 0);
  if (view)
    view(root, {...route, signal: leave.signal});
  else
    fill(
        root, h('div', {class: 'page-head'}, h('h1', null, 'No such page')),
        problemBox(
            {title: 'Not found', message: '', detail: `There is nothing at ${location.hash}.`}));
  if (document.activeElement && document.activeElement !== document.body &&
      !document.activeElement.closest('.top'))
    main.focus({preventScroll: true});
}

function setTitle(words) { document.title = words === 'home' ? 'ripnerf' : `${words} · ripnerf`; }

/** The token dialog, with why the one before was refused; resolves with what was typed, or null when it was closed. */
function askToken(why) {
  const dialog = document.getElementById('token-dialog');
  const input = document.getElementById('token-input');
  input.value = '';
  text(document.getElementById('token-why'), why);
  dialog.returnValue = '';
  if (!dialog.open) dialog.showModal();
  return new Promise(
      (resolve) => dialog.addEventListener(
          'close', () => resolve(dialog.returnValue === 'ok' ? input.value.trim() : null),
          {once: true}));
}

function showConnection({connection, jobs, uploads, info}) {
  const node = document.getElementById('connection');
  const label = {
    connecting: 'connecting',
    online: 'connected',
    offline: 'not connected'
  }[connection.status];
  text(node, label);
  node.dataset.status = connection.status;
  const active = jobs.filter(isActive);
  const count = (name) => active.filter((job) => job.state === name).length;
  const activity = document.getElementById('activity');
  text(
      activity,
      [
        ...Object.values(uploads).map(({share}) => `uploading ${Math.floor(100 * share)} %`),
        ...['running', 'queued', 'paused'].filter(count).map((name) => `${count(name)} ${name}`)
      ].join(', '));
  activity.hidden = !activity.textContent;
  const scope = document.getElementById('scope');
  text(scope, {read: 'read-only', render: 'render only'}[!isVisitor() && info?.you.scope] ?? '');
  scope.title = SCOPE_MEANS[info?.you.scope] ?? '';
  scope.hidden = !scope.textContent;
  document.getElementById('banner').hidden = connection.status !== 'offline';
}

/** Another token, with other rights: the view is built anew, with what it may. */
function startRights() {
  let before = null;
  watch(({info}) => {
    const now = info && `${info.you.id} ${info.you.scope}`;
    if (before && now !== before) show(parseRoute(location.hash));
    before = now;
  });
}

/** The banner's words count down, so they are set apart from the store's changes. */
function startBanner() {
  const banner = document.getElementById('banner');
  const words = h('span');
  const refused = () => state.connection.problem?.status === 401;
  const title = h('strong');
  fill(
      banner, title, ' ', words, ' ',
      h('button', {
        type: 'button',
        onclick: () => {
          tokenRefused = false;
          retryNow();
        }
      },
        'Try now'));
  setInterval(() => {
    if (banner.hidden) return;
    const left = Math.max(0, Math.ceil((state.connection.retryAt - Date.now()) / 1000));
    text(title, refused() ? 'The daemon asks for a token.' : 'No connection to the daemon.');
    const told = state.connection.problem?.message;
    const why = refused() ? 'Nothing can be shown without one.' :
        told              ? `It says: ${told.replace(/[.]$/, '')}.` :
                            'What is shown is from before; jobs do not need this page.';
    text(words, `${why} ${left ? `Trying again in ${left} s.` : 'Trying…'}`);
  }, 250);
}

/** Tells ends of jobs and losses of connection to a screen reader. */
function startAnnouncer() {
  const known = new Map();
  let connection = null;
  watch(({jobs, connection: now}) => {
    for (const job of jobs) {
      const before = known.get(job.id);
      if (before && before !== job.state)
        announce(`${kindOf(job)} ${subjectOf(job)}: ${job.state}`);
      known.set(job.id, job.state);
    }
    if (connection && connection !== now.status)
      announce(
          now.status === 'online'      ? 'Connected to the daemon' :
              now.status === 'offline' ? 'The daemon does not answer' :
                                         '');
    connection = now.status;
  });
}

// An upload ends with its page.
addEventListener('beforeunload', (event) => {
  if (Object.keys(state.uploads).length) event.preventDefault();
});
hooks.askToken = async (why) => {
  if (tokenRefused) return null;
  token.set(null);
  const answer = await askToken(why);
  tokenRefused = !answer;
  return answer;
};
document.getElementById('token-leave').addEventListener(
    'click', () => document.getElementById('token-dialog').close());
document.querySelector('.skip').addEventListener('click', (event) => {
  event.preventDefault();  // the hash is the router's
  main.focus();
});
takeLinkToken();
addEventListener('hashchange', (event) => {
  if (!/^#t=/.test(location.hash)) return;
  event.stopImmediatePropagation();
  takeLinkToken();
  location.reload();
});
watch(showConnection);
startBanner();
startRights();
startAnnouncer();
startRouter(show);
startSync();
