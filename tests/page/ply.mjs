// Reads the faces of a binary PLY that the program wrote, one object each.

import { readFileSync } from 'node:fs';

const SIZES = { uchar: 1, char: 1, short: 2, ushort: 2, int: 4, uint: 4, float: 4, double: 8 };
const READ = {
    uchar: 'readUInt8', char: 'readInt8', short: 'readInt16LE', ushort: 'readUInt16LE', int: 'readInt32LE', uint: 'readUInt32LE',
    float: 'readFloatLE', double: 'readDoubleLE',
};

export function faces(file) {
    const bytes = readFileSync(file);
    const end = bytes.indexOf('end_header\n') + 'end_header\n'.length;
    const elements = [];
    for (const line of bytes.subarray(0, end).toString('utf8').split('\n')) {
        const words = line.split(' ');
        if (words[0] === 'element') {
            elements.push({ name: words[1], count: Number(words[2]), properties: [] });
        } else if (words[0] === 'property') {
            elements.at(-1).properties.push(words.slice(1));
        }
    }
    let at = end;
    const take = (type) => {
        at += SIZES[type];
        return bytes[READ[type]](at - SIZES[type]);
    };
    for (const { name, count, properties } of elements) {
        const all = [];
        for (let k = 0; k < count; k++) {
            const element = {};
            for (const property of properties) {
                if (property[0] === 'list') {
                    element[property[3]] = Array.from({ length: take(property[1]) }, () => take(property[2]));
                } else {
                    element[property[1]] = take(property[0]);
                }
            }
            all.push(element);
        }
        if (name === 'face') {
            return all;
        }
    }
    return [];
}
