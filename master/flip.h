/*
 * LDR-FLIP, how different two pictures look that are shown one after the other in the same place.
 * From the formulas of P. Andersson, J. Nilsson, T. Akenine-Moeller, M. Oskarsson, K. Astroem,
 * M. D. Fairchild: "FLIP: A Difference Evaluator for Alternating Images", Proc. ACM Comput. Graph.
 * Interact. Tech. 3(2), 2020. A pure function; any thread.
 */
#ifndef MASTER_FLIP_H
#define MASTER_FLIP_H

#include <stdint.h>

/*
 * The mean over all pixels. rgb[c] are planes of linear sRGB values; they are clamped to [0, 1],
 * which is what a display would show of them, without rounding to 8 bits. `pixels_per_degree` is
 * 67 for the viewer the paper assumes. NaN when memory runs out, or there are no pixels.
 */
double flip_mean(const float *const test[3], const float *const reference[3], uint32_t width,
                 uint32_t height, double pixels_per_degree);

#endif
