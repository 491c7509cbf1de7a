// One job's event stream, taken up again where it broke off.
import {api, Problem} from './api.js';
import {readEvents} from './events.js';
import {sleep} from './dom.js';
import {isOver, putJob} from './store.js';

/**
 * Follows a job to its end, from its first event that the daemon still holds. Errors other than a
 * refusal are retried. @param {(type: string, data: any) => void} onEvent metric, frame, progress,
 * state
 */
export async function followJob(id, onEvent, signal) {
  let lastId = '0';
  let over = false;
  const take = (type, data, eventId) => {
    lastId = eventId || lastId;
    if (type === 'state') {
      over = isOver(data);
      putJob(data);
    }
    onEvent(type, data);
  };
  while (!over && !signal.aborted) {
    try {
      await readEvents(
          (headers, stop) => api.stream(`v1/jobs/${id}/events`, headers, stop),
          {lastId, signal, onEvent: take});
    } catch (error) {
      if (error instanceof Problem && error.status < 500) return;
    }
    if (!over) await sleep(1500, signal);
  }
}
