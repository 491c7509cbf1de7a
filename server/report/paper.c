// Published figures of Rip-NeRF (Liu et al. 2024, tables 1 and 2 and the ablation of its lego), by
// scene of NeRF-synthetic: PSNR over the test views, trained on train and validation views. Cited;
// how they were measured differs from here (views, split, scales, cones a pixel), as the page says.
#include <ctype.h>
#include <string.h>

#include "server/report/report.h"

#define FOUR "four scales, 800 to 100 px"
#define ONE "one scale, 800 px"

#define SCENE(name, at_25k, at_120k, alone)                                                        \
    static const struct rn_paper_figure name[] = {{"10 planes, rip; " FOUR, 25000, 32, at_25k},    \
                                                  {"10 planes, rip; " FOUR, 120000, 156, at_120k}, \
                                                  {"10 planes, rip; " ONE, 120000, NAN, alone}}
SCENE(chair, 39.36, 40.08, 37.58);
SCENE(drums, 29.40, 29.88, 27.76);
SCENE(ficus, 35.89, 36.61, 36.87);
SCENE(hotdog, 40.82, 41.98, 39.77);
SCENE(materials, 32.66, 33.79, 31.80);
SCENE(mic, 40.07, 40.94, 39.91);
SCENE(ship, 34.13, 36.18, 31.56);
static const struct rn_paper_figure lego[] = {
    {"10 planes, rip; " FOUR, 25000, 32, 36.94},  {"10 planes, rip; " FOUR, 120000, 156, 38.36},
    {"10 planes, rip; " ONE, 120000, NAN, 38.29}, {"6 planes, rip; " FOUR, 25000, NAN, 36.27},
    {"4 planes, rip; " FOUR, 25000, NAN, 34.50},  {"3 planes, rip; " FOUR, 25000, NAN, 35.98},
    {"10 planes, mip; " FOUR, 25000, NAN, 35.87}};

#define ROW(name)                                                                                  \
    { #name, name, sizeof name / sizeof *name }
static const struct {
    const char *name;
    const struct rn_paper_figure *figures;
    size_t count;
} scenes[] = {ROW(chair), ROW(drums),     ROW(ficus), ROW(hotdog),
              ROW(lego),  ROW(materials), ROW(mic),   ROW(ship)};

size_t rn_report_paper(const char *dataset_name, const struct rn_paper_figure **ret_figures) {
    *ret_figures = NULL;
    for (size_t i = 0; i < sizeof scenes / sizeof *scenes; i++) {
        size_t size = strlen(scenes[i].name);
        if (strncmp(dataset_name, scenes[i].name, size) != 0 ||
            isalpha((unsigned char)dataset_name[size]))
            continue;
        *ret_figures = scenes[i].figures;
        return scenes[i].count;
    }
    return 0;
}
