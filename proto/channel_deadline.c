#include "proto/channel_inside.h"

#define GRACE_MS 500 /* see on_stage_timer() */

static void expire_stage(struct channel *channel)
{
    switch (channel->state) {
    case CONNECTING:
        channel_fail_with(channel, ERR_TIMEOUT, "no connection in time");
        break;
    case HANDSHAKE:
        channel_fail_with(channel, ERR_TIMEOUT, "no TLS handshake in time");
        break;
    case OPEN:
        channel_fail_with(channel, ERR_TIMEOUT, "no greeting in time");
        break;
    case CLOSING:
    case ENDED:
        channel_finish(channel);
        break;
    }
}

/*
 * A timer that is due may only mean that this process did not run for a while (SIGSTOP, a laptop's
 * lid) and the peer's bytes wait unread. So a deadline gives another moment before it counts.
 */
static void on_stage_timer(uv_timer_t *timer)
{
    struct channel *channel = timer->data;
    if (channel->stage_grace) {
        expire_stage(channel);
        return;
    }
    channel->stage_grace = true;
    uv_timer_start(timer, on_stage_timer, GRACE_MS, 0);
}

void channel_deadline_stage(struct channel *channel, uint32_t ms)
{
    channel->stage_grace = ms <= GRACE_MS;
    uint32_t until_grace = channel->stage_grace ? ms : ms - GRACE_MS;
    uv_timer_start(&channel->stage_timer, on_stage_timer, until_grace, 0);
}

static void on_silence_timer(uv_timer_t *timer)
{
    struct channel *channel = timer->data;
    uint64_t silent_ms = uv_now(channel->loop) - channel->heard_ms;
    if (channel->paused) {
        silent_ms = 0; /* we are the ones who do not listen */
        channel->heard_ms = uv_now(channel->loop);
    }
    if (silent_ms < channel->silence_ms) {
        channel->silence_grace = false;
        uv_timer_start(timer, on_silence_timer, channel->silence_ms - silent_ms, 0);
    } else if (!channel->silence_grace) {
        channel->silence_grace = true;
        uv_timer_start(timer, on_silence_timer, GRACE_MS, 0);
    } else {
        channel_fail_with(channel, ERR_TIMEOUT, "the peer stayed silent for too long");
    }
}

void channel_deadline_silence(struct channel *channel, uint32_t silence_ms)
{
    channel->silence_ms = silence_ms;
    channel->silence_grace = false;
    channel->heard_ms = uv_now(channel->loop);
    if (channel->state != OPEN)
        return;
    if (silence_ms > 0)
        uv_timer_start(&channel->silence_timer, on_silence_timer, silence_ms, 0);
    else
        uv_timer_stop(&channel->silence_timer);
}
