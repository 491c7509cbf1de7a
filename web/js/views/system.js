// What the daemon runs on and its limits.
import {token} from '../api.js';
import {fill, h} from '../dom.js';
import {isVisitor, watch} from '../store.js';
import {bytes, seconds, whole} from '../format.js';
import {facts, panel, SCOPE_MEANS, skeleton} from '../ui.js';

export function systemView(root, {signal}) {
  const box = h('div', {class: 'columns even'});
  fill(root, h('div', {class: 'page-head'}, h('h1', null, 'System')), box);
  let shown = null;
  watch(({info}) => {
    if (info === shown && shown) return;
    shown = info;
    if (!info) {
      fill(box, panel('Daemon', null, skeleton(4)));
      return;
    }
    const {limits} = info;
    fill(
        box,
        panel('Daemon', null, facts([
                ['Version', info.version], ['Up for', seconds(info.uptime_s)],
                ['Device', info.device_name || info.device || 'not probed yet'],
                [
                  'Kernels',
                  `${info.kernels || '–'}${
                      info.available_kernels.length ? ` (of ${info.available_kernels.join(', ')})` :
                                                      ''}`
                ],
                ['Threads', whole(info.threads)],
                [
                  'Films', info.films ? 'MP4, WebM and GIF' :
                                        'none, but frames: ripnerf-film.so is not installed'
                ],
                ...(info.executor ? [['Trains on', 'a Slurm cluster; jobs tell where']] : []),
                [
                  'Memory for scenes',
                  info.memory_limit_bytes ? bytes(info.memory_limit_bytes) : 'no limit'
                ],
                [
                  'Dataset folders',
                  info.roots.length ? info.roots.map((root) => h('code', {class: 'line'}, root)) :
                                      'none (start it with --dataset-root)'
                ]
              ])),
        panel('Limits', null, facts([
                [
                  'Upload',
                  `${bytes(limits.max_upload_bytes)}, ${whole(limits.max_upload_entries)} files`
                ],
                ['Request', bytes(limits.max_body_bytes)],
                ['Picture', `${whole(limits.max_render_pixels)} pixels`],
                ['Jobs waiting', whole(limits.max_queued_jobs)],
                ['Training at once', whole(limits.max_training_jobs)],
                ['Scenes loaded', whole(limits.max_scenes_loaded)]
              ])),
        panel(
            'This page', null,
            h('p', null, 'Everything here goes through the documented interface: ',
              token.get() ? h('code', null, 'v1/openapi.json') :  // a link carries no token
                            h('a', {href: 'v1/openapi.json'}, 'openapi.json'),
              '.'),
            token.get() ?
                [
                  h('p', {class: 'quiet'},
                    `Its token is ${info.you.name ?? 'the daemon’s own'}, with the scope ${
                        info.you.scope}${
                        info.you.expires_at ?
                            `, until ${info.you.expires_at.slice(0, 16).replace('T', ' ')} UTC` :
                            ''}. ${isVisitor() ? '' : SCOPE_MEANS[info.you.scope] ?? ''}`),
                  h('button', {
                    type: 'button',
                    onclick: () => {
                      token.set(null);
                      location.reload();
                    }
                  },
                    'Forget the token')
                ] :
                h('p', {class: 'quiet'}, 'No token is in use.')));
  }, signal);
}
