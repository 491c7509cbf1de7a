// What a link is for, in the place of lists that it does not have.
import {fill, h} from '../dom.js';
import {panel} from '../ui.js';
import {link} from '../router.js';

/** Fills a view, once: a visitor's records are read again and again. @param {any} state of the store */
export function showVisit(root, state) {
  if (root.dataset.visit) return;
  root.dataset.visit = 'true';
  fill(root, h('h1', {class: 'unseen'}, 'What this link shows'), visitPanel(state));
}

function visitPanel({info, scenes, jobs}) {
  const {scene, expires_at: end} = info.you;
  const what = scene ? ['scene', scenes[0]?.name ?? scene, link.scene(scene), 'Look at it'] :
                       ['camera path', jobs[0]?.scene_name ?? info.you.job, link.job(info.you.job),
                        'See its pictures'];
  return panel(
      'A link', null,
      h('p', null, `You came by a link to one ${what[0]}, `, h('strong', null, what[1]),
        ', to look at and no more. Nothing else is listed.'),
      end ? h('p', {class: 'quiet'}, `It ends on ${end.slice(0, 10)}.`) : null,
      h('div', {class: 'row'}, h('a', {class: 'button primary', href: what[2]}, what[3])));
}
